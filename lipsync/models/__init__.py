"""Shipped model files, each with its model card beside it, and the page's head; no code."""

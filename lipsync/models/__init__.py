"""Shipped model files, each with its model card beside it; no code."""

"""Shipped models, each with its model card beside it. Data only."""

"""Recorded speech with mouth motion: readers, head-motion removal, splits."""

"""What a rater's browser gets: one page, its script and its style; nothing from elsewhere."""

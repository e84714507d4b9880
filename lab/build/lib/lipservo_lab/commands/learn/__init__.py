"""Commands that learn from recordings, or listen to them."""

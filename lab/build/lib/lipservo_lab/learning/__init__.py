"""How each model that ships is learned from recordings."""

"""Output to a terminal or web page: text, progress, pictures, a live view; and keys read."""

"""How accurate and how quick a recogniser is."""

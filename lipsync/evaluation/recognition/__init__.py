"""How well and how soon a recogniser hears."""

"""Which mouth looks right: clips shown to people, blind and balanced, and what they say of them."""

"""What the live page draws, and other pages with it."""

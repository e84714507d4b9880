"""Scripts of the elements on the live page, which other pages load, too."""

"""Scripts of the page that shows a face large, and a robot by its own model."""

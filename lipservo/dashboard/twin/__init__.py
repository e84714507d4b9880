"""The digital twin on a page: the route of its head, its NiceGUI element, and its JavaScript."""

"""The digital twin on a page: what serves its head, the NiceGUI element, and what draws it."""

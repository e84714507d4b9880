"""A human face for displays: a mesh that the markers of a face model deform as a thin shell."""

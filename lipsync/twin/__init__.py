"""A human face to look at: a mesh that the markers of a face model deform as a thin shell."""

"""A corpus becomes a state model: parameters, manifold, states, units."""

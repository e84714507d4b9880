"""`lipservo bench display`: photographs that are warped, and films, by what can be measured."""

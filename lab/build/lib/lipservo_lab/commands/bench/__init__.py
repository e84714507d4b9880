"""`lipservo bench`: what the documentation claims, measured."""

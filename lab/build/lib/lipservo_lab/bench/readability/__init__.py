"""`lipservo bench readability`: which words can be read off recorded, made and robot mouths."""

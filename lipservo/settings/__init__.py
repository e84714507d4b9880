"""A face's YAML: what it may say, and how an error in it is told."""

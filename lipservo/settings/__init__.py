"""A face's YAML: its keys, and how an error in it is reported."""

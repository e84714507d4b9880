"""The face YAML: its settings, how it is read and edited, and how errors in it are reported."""

"""The commands, one module a group; `lipservo.cli` joins them."""

"""How well words can be read off a mouth by a reader who learned them from recorded faces."""

"""What a running face says of itself."""

"""Scripts and styles of the kiosk's page."""

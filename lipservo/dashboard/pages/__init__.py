"""The web pages of the dashboard, made with NiceGUI and drawn in the browser."""

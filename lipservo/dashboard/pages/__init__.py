"""The pages of the dashboard: what a builder sees, drawn in the browser."""

"""The pages of the dashboard: what a builder sees, drawn in the browser."""

from lipservo.dashboard.pages.pages import build_pages

__all__ = ["build_pages"]

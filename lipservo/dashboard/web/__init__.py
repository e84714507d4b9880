"""The dashboard's server: access control, API, streams, metrics, and the application of pages."""

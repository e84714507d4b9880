"""The dashboard's server: who may come in, the API, the streams, metrics, and the pages' app."""

"""JavaScript modules that draw a twin from frames, in the browser."""

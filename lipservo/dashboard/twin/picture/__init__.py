"""What runs in the browser: JavaScript modules that draw a twin from frames."""

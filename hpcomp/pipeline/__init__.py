"""One picture, strip by strip, from files to a file."""

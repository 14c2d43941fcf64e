"""What stored numbers mean as light: curves, primaries, blending spaces, gamut. No files."""

"""What blending did to labels, in numbers that add up. No files, no text."""

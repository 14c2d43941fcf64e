"""From LAYER texts to open layers on one canvas, and what is said of them."""

"""Questions about layers and pictures: is it right, why is it so, which colours. Prints nothing."""

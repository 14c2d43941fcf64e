"""What hpcomp tells people and scripts about pictures: text, JSON. No pixels are computed here."""

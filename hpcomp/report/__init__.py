"""What hpcomp tells people and scripts about pictures: text, data, figures. Counts no pixels."""

"""The mathematics: ⊕, orders, operators, and the rules of a stack. numpy only, no files."""

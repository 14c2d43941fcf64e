"""Who composites: the contract, the choice, the numpy reference, arrays and deep samples."""

"""How often the filter keeps the contract that a certificate assumes."""

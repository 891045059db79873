"""How often the filter keeps the contract that the certificate of the tuned law assumes."""

"""How fast any law could be: optimal drives as a bound."""

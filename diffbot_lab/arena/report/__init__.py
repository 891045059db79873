"""What the arena's runs come to: statistics as text, figures and targets."""

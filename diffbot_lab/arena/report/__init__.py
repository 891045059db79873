"""What the arena's runs come to: statistics as text, pages, figures and targets."""

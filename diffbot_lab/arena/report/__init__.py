"""Results of the arena: tables, a figure, and where a peer is ahead."""

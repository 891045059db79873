"""The filter over a recorded bag: no graph, no waiting, the same bits each time."""

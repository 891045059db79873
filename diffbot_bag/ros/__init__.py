"""The recorder's view of the graph: its topics, and publishers that its subscriptions do not match."""

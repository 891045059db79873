"""Who may do what in the graph: an SROS2 policy of least privilege, written from nodes that run."""

"""Scene, device profile -> CostModel: what drawing costs, in integers."""

"""The physical world: plant, grasps, clock, scenarios, metrics, recorder."""

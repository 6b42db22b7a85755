"""Record check: a record against itself and its rig, before a model is fitted to it."""

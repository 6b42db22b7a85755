"""Demo: from bags to a controlled rig, in one command."""

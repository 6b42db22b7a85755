"""The command that notes what a model was trained on."""

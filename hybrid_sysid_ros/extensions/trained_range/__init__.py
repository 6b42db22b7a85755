"""What a model was trained on, and where a use of it leaves that."""

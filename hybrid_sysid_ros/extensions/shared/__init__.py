"""What several extensions share, and the trunk does not need: no extension itself."""

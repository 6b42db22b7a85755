"""Extensions: neighbours of the trunk, one folder each, found by their entry points."""

"""A drill string: a slender shaft turned at its top, whose bit sticks and slips."""

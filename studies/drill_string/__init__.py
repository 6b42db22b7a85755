"""A public record of a laboratory drill string that sticks and slips."""

"""Input bias: a constant bias of each input, estimated at the beginning of a record."""

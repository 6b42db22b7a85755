"""Reading a joint's angle out of pictures, and the time out of a film: layers, alignment, synchronisation."""

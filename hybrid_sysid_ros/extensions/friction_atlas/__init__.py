"""Friction atlas: the laws of friction by name, on a sliding block, in four experiments that tell them apart."""

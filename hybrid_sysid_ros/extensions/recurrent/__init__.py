"""Recurrent: a gated recurrent network as a model structure, trained by gradients through time."""

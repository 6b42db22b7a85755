"""Tuning: weights, horizon and filter noises of a rig's loop by closed loops of its certificate's distribution."""

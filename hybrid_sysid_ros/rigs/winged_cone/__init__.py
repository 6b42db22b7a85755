"""A winged-cone vehicle: the longitudinal motion of a hypersonic concept, whose pitch is unstable."""

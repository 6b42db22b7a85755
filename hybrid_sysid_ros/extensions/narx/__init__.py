"""NARX: polynomials in lagged outputs and inputs, alone or driving a parallel model of a gray box's residual."""

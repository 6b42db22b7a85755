"""A linear beam and a control problem of the beam, which tests of its MPC share."""

from hybrid_sysid_ros.control import ControlProblem
from tests.one_joint import Linear

LINEAR = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)
PROBLEM = ControlProblem(
    horizon=10,
    period=0.02,
    substeps=4,
    output_weights=(100.0,),
    rate_weights=(1.0,),
    input_low=(-10.0,),
    input_high=(10.0,),
    output_scales=(0.0227,),
    smoothing=0.005,
    max_iterations=100,
)

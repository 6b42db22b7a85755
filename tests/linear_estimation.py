"""A linear beam and the noise of its sensor, for tests of the estimators."""

import dataclasses

from hybrid_sysid_ros.estimation import Tuning
from tests.one_joint import Linear
from tests.straight_beam import straight

PERIOD = 0.005
LINEAR = straight(Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0))
QUIET = Tuning(
    measurement_noise=(5e-4,),
    process_noise=(1e-4, 0.2),
    disturbance_noise=(0.05,),
    disturbance_limit=(1e3,),
    hum_hertz=(0.0,),
    hum_amplitude=(0.0,),
    hum_noise=(0.0,),
    gate=1e9,
    patience=5,
)
HUM = dataclasses.replace(QUIET, hum_hertz=(60.0,), hum_amplitude=(2e-3,), hum_noise=(1e-4,))

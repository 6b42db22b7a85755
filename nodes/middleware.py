"""Middleware: settings of Fast DDS, the default of ROS 2, to find peers soon and to free memory of large messages."""

from __future__ import annotations

import os

from rclpy.utilities import get_rmw_implementation_identifier

from hybrid_sysid_ros.runtime.parameters import DECLARATIONS

PROFILES = DECLARATIONS.with_name("fast_dds.xml")
VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Environment variables for a file of profiles, of Fast DDS up to version 2 and from 3 on."""
WHOLE = "RMW_FASTRTPS_USE_QOS_FROM_XML"
"""Environment variable by which ROS reads settings of memory from that file, which no quality of service has."""
ALONE = "HYBRID_SYSID_IGNORE_LOCAL"
"""Variable of the file by which nodes of one process don't communicate through Fast DDS."""


def prepare_middleware(*, together: bool = False) -> None:
    """Give Fast DDS this package's profiles, unless the user gives it another file. Call it before the first node is
    made. together: nodes of this process have an exchange.

    Participants announce themselves five times, a tenth of a second apart, then every three seconds. Announcements get
    lost while processes start, and a node discovers the others only three seconds later
    (https://fast-dds.docs.eprosima.com/en/v2.14.4/fastdds/discovery/simple.html). Each place of a history, of which a
    recorder has ten thousand, keeps the memory of the largest message that it ever had. Other middlewares ignore this.
    """
    if not any(os.environ.get(name) for name in VARIABLES):
        os.environ.update({**dict.fromkeys(VARIABLES, str(PROFILES)), WHOLE: "1", ALONE: str(together).lower()})


def leaves_alone() -> bool:
    """Whether the variable has an effect: the middleware is Fast DDS with this package's file."""
    ours = any(os.environ.get(name) == str(PROFILES) for name in VARIABLES)
    return ours and "fastrtps" in str(get_rmw_implementation_identifier()) and os.environ.get(ALONE) == "true"

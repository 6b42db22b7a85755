"""Middleware: what Fast DDS, by default that of ROS 2, is told: find peers soon, keep no memory of large messages."""

from __future__ import annotations

import os

from rclpy.utilities import get_rmw_implementation_identifier

from hybrid_sysid_ros.runtime.parameters import DECLARATIONS

PROFILES = DECLARATIONS.with_name("fast_dds.xml")
VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""By which Fast DDS, up to version 2 and from 3 on, is given a file of profiles."""
WHOLE = "RMW_FASTRTPS_USE_QOS_FROM_XML"
"""By which ROS takes from that file what no quality of service of its own says: how memory is kept."""
ALONE = "HYBRID_SYSID_IGNORE_LOCAL"
"""That variable of the file by which nodes of one process don't hear one another through Fast DDS."""


def prepare_middleware(*, together: bool = False) -> None:
    """Give Fast DDS this package's profiles, unless the user gives it a file of his own. Before the first node.
    together: nodes of this process have an exchange.

    Participants announce themselves five times, a tenth of a second apart, then every three seconds; while processes
    start, announcements get lost, and a node that is there hears of the others three seconds later
    (https://fast-dds.docs.eprosima.com/en/v2.14.4/fastdds/discovery/simple.html). And each place of a history, of
    which a recorder has ten thousand, keeps the memory of the largest message that it ever held. Other middlewares
    don't look.
    """
    if not any(os.environ.get(name) for name in VARIABLES):
        os.environ.update({**dict.fromkeys(VARIABLES, str(PROFILES)), WHOLE: "1", ALONE: str(together).lower()})


def leaves_alone() -> bool:
    """Whether it heeds that variable: it is Fast DDS, with this package's file."""
    ours = any(os.environ.get(name) == str(PROFILES) for name in VARIABLES)
    return ours and "fastrtps" in str(get_rmw_implementation_identifier()) and os.environ.get(ALONE) == "true"

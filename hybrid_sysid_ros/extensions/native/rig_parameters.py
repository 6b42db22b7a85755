"""Which parameters of the nodes a native loop may change, and when."""

NODES = ("estimator", "controller")
LIVE = frozenset(
    {
        *("warn_share", "error_share", "stale_seconds", "innovation_warn", "innovation_error"),
        *("stale_after", "zero_after", "stop_seconds"),
    }
)
"""Parameters that may change while the loop runs."""
AT_START = LIVE | {
    *("autostart", "stamp_ahead", "stamp_behind", "silence", "priority", "lockstep", "sensor_timeout", "armed"),
    "use_sim_time",
}
"""Parameters that may have another value at each start; the others are parts of the compiled loop."""
UNWATCHED_SENSORS = "checks of extensions"
UNWATCHED_LOOP = "changes of the files that were loaded"
"""What the native loop does not do, as it says itself."""

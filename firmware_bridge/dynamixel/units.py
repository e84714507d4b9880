"""Units of the registers of Dynamixel X servos.

https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#control-table
"""

from typing import Final

#: goal_position, present_position and the position limits.
PULSES_PER_TURN: Final = 4096
PULSES_PER_DEG: Final = PULSES_PER_TURN / 360.0
CENTER_PULSE: Final = 2048
#: profile_velocity: 0.229 rev/min.
VELOCITY_UNIT_DEG_S: Final = 0.229 * 6.0
#: bus_watchdog.
WATCHDOG_UNIT_S: Final = 0.020
#: return_delay_time.
RETURN_DELAY_UNIT_S: Final = 2e-6

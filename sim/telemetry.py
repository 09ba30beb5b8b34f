"""What a vehicle tells of itself: each message built from the vehicle's state, and when it is due."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from missionplanner.geodesy import FloatArray
from missionplanner.vehicle import true_airspeed
from sim.autopilot import Autopilot
from sim.mission_service import with_plan_ids
from sim.personality import Behaviour

MISSION_CURRENT = int(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)
EXTENDED_SYS_STATE = int(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
WIND = int(mavlink.MAVLINK_MSG_ID_WIND)
WIND_COV = int(mavlink.MAVLINK_MSG_ID_WIND_COV)
HEARTBEAT = int(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
HOME_POSITION = int(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
GLOBAL_POSITION_INT = int(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
SYS_STATUS = int(mavlink.MAVLINK_MSG_ID_SYS_STATUS)

_INTERVAL_MAX_US = 2**31 - 1  # as MESSAGE_INTERVAL can say it
_MAX_UINT16 = 65_535
_BATTERY_CELLS = 4
_BATTERY_FULL_MV = 16_800
_BATTERY_EMPTY_MV = 14_000
_BATTERY_CAPACITY_MAH = 5_200

_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION
    | mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)
_EKF_ATTITUDE = mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_VERT | mavlink.EKF_POS_VERT_ABS
_EKF_READY = (
    _EKF_ATTITUDE
    | mavlink.EKF_VELOCITY_HORIZ
    | mavlink.EKF_POS_HORIZ_REL
    | mavlink.EKF_POS_HORIZ_ABS
    | mavlink.EKF_PRED_POS_HORIZ_REL
    | mavlink.EKF_PRED_POS_HORIZ_ABS
)

# ArduPilot's groups for REQUEST_DATA_STREAM
_STREAMS: dict[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: (),
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        MISSION_CURRENT,
        mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
        WIND,
    ),
}
STREAM_ALL = int(mavlink.MAV_DATA_STREAM_ALL)


@dataclass(slots=True)
class Motion:
    """Where the vehicle is at this instant; the fleet fills it for all vehicles at once."""

    lat_deg: float
    lon_deg: float
    position_m: FloatArray
    velocity_m_s: FloatArray
    course_rad: float = 0.0  # over the ground: kept while standing still
    nose_rad: float = 0.0  # a copter's follows its course, a plane's the air
    wind_m_s: tuple[float, float] = (0.0, 0.0)  # velocity of the air: east, north


@dataclass(slots=True)
class _Message:
    build: Callable[[float], Any]
    interval_s: float  # infinite: only on request
    default_interval_s: float = field(init=False)
    due_s: float = math.inf

    def __post_init__(self) -> None:
        self.default_interval_s = self.interval_s


class Telemetry:
    """One vehicle's stream of messages.

    Positions go out ``position_hz`` times a second, slow ones once, and what changes seldom also whenever it changes.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        sysid: int,
        motion: Callable[[], Motion],
        home_geo: Callable[[], tuple[float, float]],
        *,
        position_hz: float,
        phase_s: float,
        battery_life_s: float,
        plan_ids: Callable[[], tuple[int, int, int]],
    ) -> None:
        self._autopilot = autopilot
        self._sysid = sysid
        self._motion = motion
        self._home_geo = home_geo
        self._battery_life_s = battery_life_s
        self._plan_ids = plan_ids
        self._boot_s = 0.0
        ardupilot = autopilot.personality.autopilot == "ardupilot"
        on_request = math.inf
        second = 1.0
        self._messages: dict[int, _Message] = {
            HEARTBEAT: _Message(self._heartbeat, second),
            SYS_STATUS: _Message(self._sys_status, second),
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _Message(self._gps_raw_int, second),
            GLOBAL_POSITION_INT: _Message(self._global_position_int, 1.0 / position_hz),
            mavlink.MAVLINK_MSG_ID_ATTITUDE: _Message(self._attitude, second),
            mavlink.MAVLINK_MSG_ID_VFR_HUD: _Message(self._vfr_hud, second),
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _Message(self._local_position_ned, second),
            MISSION_CURRENT: _Message(self._mission_current, second),
            EXTENDED_SYS_STATE: _Message(self._extended_sys_state, second),
            HOME_POSITION: _Message(self._home_position, on_request if ardupilot else 2.0),
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: _Message(self._battery_status, 5.0),
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _Message(self._system_time, 5.0),
            mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: _Message(self._nav_controller_output, on_request),
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _Message(self._gps_global_origin, on_request),
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _Message(self._autopilot_version, on_request),
        }
        if ardupilot:
            self._messages[mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT] = _Message(self._ekf_status_report, second)
        else:
            self._messages[mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS] = _Message(self._estimator_status, second)
        self._plane = autopilot.personality.vehicle_class == "plane"
        if self._plane:  # without an airspeed, copters know no wind: neither autopilot's default tells of it
            self._messages[WIND if ardupilot else WIND_COV] = _Message(
                self._wind if ardupilot else self._wind_cov, second
            )
        for message in self._messages.values():
            if math.isfinite(message.interval_s):
                message.due_s = phase_s
        self._seen: tuple[Any, ...] = ()
        self._due_s = phase_s

    @property
    def due_s(self) -> float:
        """When the next message is due."""
        return self._due_s

    def due(self, now_s: float) -> list[Any]:
        """Return the messages due by ``now_s``."""
        if now_s < self._due_s:
            return []
        out = []
        for message in self._messages.values():
            if message.due_s <= now_s:
                out.append(message.build(now_s))
                message.due_s += message.interval_s
                if message.due_s <= now_s:  # an interval shorter than the tick
                    message.due_s = now_s + message.interval_s
        self._due_s = min(message.due_s for message in self._messages.values())
        return out

    def changed(self, now_s: float) -> list[Any]:
        """Return the messages whose subject has changed since the last call."""
        autopilot = self._autopilot
        seen = (
            # once a second, armed or not; ArduPilot tells of a mode at once
            autopilot.mode.custom_mode if autopilot.personality.autopilot == "ardupilot" else None,
            (autopilot.current, autopilot.mission_state, len(autopilot.mission)),
            autopilot.landed_state,
            tuple(autopilot.home_m),
        )
        kinds = (HEARTBEAT, MISSION_CURRENT, EXTENDED_SYS_STATE, HOME_POSITION)
        if not self._seen:
            self._seen = seen
        out = [
            self._messages[kind].build(now_s)
            for kind, old, new in zip(kinds, self._seen, seen, strict=True)
            if old != new
        ]
        self._seen = seen
        return out

    def reboot(self, awake_s: float) -> None:
        """Be silent until then, and begin anew: with the clock, and with what is sent by default."""
        self._boot_s = awake_s
        for message in self._messages.values():
            message.interval_s = message.default_interval_s
            message.due_s = awake_s if math.isfinite(message.interval_s) else math.inf
        self._due_s = awake_s

    def up_s(self, now_s: float) -> float:
        """Return the time since the vehicle booted."""
        return now_s - self._boot_s

    def photo(self, number: int, now_s: float) -> Any:
        """Return what the vehicle tells of a photo just taken, its number counted from 1."""
        motion, up_s = self._motion(), self.up_s(now_s)
        x, y = round(motion.lat_deg * 1e7), round(motion.lon_deg * 1e7)
        alt_m = float(motion.position_m[2])
        home_m = alt_m - float(self._autopilot.home_m[2])
        if self._autopilot.personality.autopilot == "ardupilot":
            nose_deg = math.degrees(motion.nose_rad)
            return mavlink.MAVLink_camera_feedback_message(
                round(up_s * 1e6), 0, 0, number, x, y, alt_m, home_m, 0.0, 0.0, nose_deg, 0.0,
                mavlink.CAMERA_FEEDBACK_PHOTO, number,
            )  # fmt: skip
        level = (1.0, 0.0, 0.0, 0.0)
        return mavlink.MAVLink_camera_image_captured_message(
            round(up_s * 1e3), 0, 0, x, y, round(alt_m * 1e3), round(home_m * 1e3), level, number - 1, 1, b""
        )

    def build(self, message_id: int, now_s: float) -> Any | None:
        """Return one message by its id; None where the vehicle has no such message."""
        message = self._messages.get(message_id)
        return None if message is None else message.build(now_s)

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """Send a message every so many microseconds: 0 as by default, negative never. False: unknown message."""
        message = self._messages.get(message_id)
        if message is None or not math.isfinite(interval_us):
            return False
        if interval_us < 0:
            message.interval_s = math.inf
        else:
            message.interval_s = interval_us * 1e-6 if interval_us > 0 else message.default_interval_s
        message.due_s = now_s + message.interval_s
        self._due_s = min(self._due_s, message.due_s)
        return True

    def interval_us(self, message_id: int) -> int | None:
        """Return the interval of a message in microseconds (-1: never), or None where there is no such message."""
        message = self._messages.get(message_id)
        if message is None:
            return None
        if not math.isfinite(message.interval_s):
            return -1
        return min(round(message.interval_s * 1e6), _INTERVAL_MAX_US)

    def set_stream(self, stream: int, rate_hz: int, on: bool, now_s: float) -> None:
        """Obey REQUEST_DATA_STREAM."""
        streams = _STREAMS if stream == STREAM_ALL else {stream: _STREAMS.get(stream, ())}
        for messages in streams.values():
            for message_id in messages:
                self.set_interval(message_id, 1e6 / rate_hz if on and rate_hz > 0 else -1.0, now_s)

    # -- the messages ------------------------------------------------------------------------------------------------

    def _heartbeat(self, now_s: float) -> Any:
        autopilot = self._autopilot
        px4 = autopilot.personality.autopilot == "px4"
        manual = autopilot.mode.behaviour in (Behaviour.HOLD, Behaviour.TAKEOFF)
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if manual or not px4:  # ArduPilot always heeds the sticks
            base |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        if not manual:
            base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
            base |= mavlink.MAV_MODE_FLAG_AUTO_ENABLED if px4 else 0
        if autopilot.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        if now_s < autopilot.ready_s:
            status = mavlink.MAV_STATE_CALIBRATING
        else:
            status = mavlink.MAV_STATE_STANDBY if autopilot.landed else mavlink.MAV_STATE_ACTIVE
        kind = autopilot.personality
        return mavlink.MAVLink_heartbeat_message(
            kind.type_id, kind.autopilot_id, base, autopilot.mode.custom_mode, status, 3
        )

    def _battery(self, now_s: float) -> tuple[int, int, int]:
        """Return (remaining percent, millivolts, centiamperes)."""
        used = min(self._autopilot.flown_s(now_s) / self._battery_life_s, 1.0)
        voltage_mv = _BATTERY_FULL_MV - used * (_BATTERY_FULL_MV - _BATTERY_EMPTY_MV)
        draw_ca = 100 * 3.6 * _BATTERY_CAPACITY_MAH / self._battery_life_s if not self._autopilot.landed else 50.0
        return round(100 * (1.0 - used)), round(voltage_mv), round(draw_ca)

    def _sys_status(self, now_s: float) -> Any:
        ready = now_s >= self._autopilot.ready_s
        sensors = _SENSORS | mavlink.MAV_SYS_STATUS_PREARM_CHECK
        # a fence that is not there is healthy too: ground stations would call it breached
        healthy = (sensors if ready else _SENSORS & ~mavlink.MAV_SYS_STATUS_AHRS) | mavlink.MAV_SYS_STATUS_GEOFENCE
        percent, voltage_mv, current_ca = self._battery(now_s)
        return mavlink.MAVLink_sys_status_message(
            sensors, sensors, healthy, 100, voltage_mv, current_ca, percent, 0, 0, 0, 0, 0, 0
        )

    def _battery_status(self, now_s: float) -> Any:
        percent, voltage_mv, current_ca = self._battery(now_s)
        cells = [voltage_mv // _BATTERY_CELLS] * _BATTERY_CELLS + [_MAX_UINT16] * (10 - _BATTERY_CELLS)
        used_mah = round((100 - percent) / 100 * _BATTERY_CAPACITY_MAH)
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_LIPO,
            2500,
            cells,
            current_ca,
            used_mah,
            -1,
            percent,
        )

    def _gps_raw_int(self, now_s: float) -> Any:
        motion = self._motion()
        east, north, _ = motion.velocity_m_s
        speed_cm_s = min(round(100 * math.hypot(east, north)), _MAX_UINT16 - 1)
        return mavlink.MAVLink_gps_raw_int_message(
            round(self.up_s(now_s) * 1e6),
            mavlink.GPS_FIX_TYPE_3D_FIX if now_s < self._autopilot.ready_s else mavlink.GPS_FIX_TYPE_RTK_FIXED,
            round(motion.lat_deg * 1e7),
            round(motion.lon_deg * 1e7),
            round(motion.position_m[2] * 1e3),
            80,
            100,
            speed_cm_s,
            round(math.degrees(motion.course_rad) * 100) % 36_000,
            14,
        )

    def _global_position_int(self, now_s: float) -> Any:
        motion = self._motion()
        east, north, up = motion.velocity_m_s
        alt_m = motion.position_m[2]
        return mavlink.MAVLink_global_position_int_message(
            round(self.up_s(now_s) * 1e3),
            round(motion.lat_deg * 1e7),
            round(motion.lon_deg * 1e7),
            round(alt_m * 1e3),
            round((alt_m - self._autopilot.home_m[2]) * 1e3),
            round(north * 100),
            round(east * 100),
            round(-up * 100),
            round(math.degrees(motion.nose_rad) * 100) % 36_000,
        )

    def _local_position_ned(self, now_s: float) -> Any:
        motion = self._motion()
        x_m, y_m, up_m = motion.position_m - self._autopilot.home_m
        east, north, up = motion.velocity_m_s
        return mavlink.MAVLink_local_position_ned_message(
            round(self.up_s(now_s) * 1e3), y_m, x_m, -up_m, north, east, -up
        )

    def _attitude(self, now_s: float) -> Any:
        yaw = math.remainder(self._motion().nose_rad, 2 * math.pi)
        return mavlink.MAVLink_attitude_message(round(self.up_s(now_s) * 1e3), 0.0, 0.0, yaw, 0.0, 0.0, 0.0)

    def _vfr_hud(self, now_s: float) -> Any:
        del now_s
        motion = self._motion()
        east, north, up = motion.velocity_m_s
        speed = math.hypot(east, north)
        throttle = 0 if self._autopilot.landed else 40
        heading = round(math.degrees(motion.nose_rad)) % 360
        airspeed = speed  # what copters without an airspeed sensor tell
        if self._plane:
            wind_east, wind_north = motion.wind_m_s
            airspeed = 0.0 if self._autopilot.landed else math.hypot(east - wind_east, north - wind_north)
            airspeed /= true_airspeed(float(motion.position_m[2]))
        return mavlink.MAVLink_vfr_hud_message(airspeed, speed, heading, throttle, motion.position_m[2], up)

    def _wind_felt(self) -> tuple[float, float]:
        """Return the velocity of the air, east and north, as it has been found out in flight."""
        return (0.0, 0.0) if self._autopilot.landed else self._motion().wind_m_s

    def _wind(self, now_s: float) -> Any:
        del now_s
        east, north = self._wind_felt()
        return mavlink.MAVLink_wind_message(
            math.degrees(math.atan2(0.0 - east, 0.0 - north)), math.hypot(east, north), 0.0
        )

    def _wind_cov(self, now_s: float) -> Any:
        east, north = self._wind_felt()
        alt_m = float(self._motion().position_m[2])
        return mavlink.MAVLink_wind_cov_message(
            round(self.up_s(now_s) * 1e6), north, east, 0.0, 0.1, 0.1, alt_m, 0.3, 0.3
        )

    def _mission_current(self, now_s: float) -> Any:
        del now_s
        autopilot = self._autopilot
        mode = 1 if autopilot.flying_mission else 2  # active, suspended
        total = len(autopilot.mission)
        if autopilot.personality.transfer.home_is_item_0:
            total = max(total - 1, 0)  # home is not counted
        elif total == 0:
            total = _MAX_UINT16
        message = mavlink.MAVLink_mission_current_message(autopilot.current, total, int(autopilot.mission_state), mode)
        return with_plan_ids(message, *self._plan_ids())

    def _extended_sys_state(self, now_s: float) -> Any:
        del now_s
        return mavlink.MAVLink_extended_sys_state_message(
            mavlink.MAV_VTOL_STATE_UNDEFINED, int(self._autopilot.landed_state)
        )

    def _home_position(self, now_s: float) -> Any:
        lat_deg, lon_deg = self._home_geo()
        alt_mm = round(float(self._autopilot.home_m[2]) * 1e3)
        return mavlink.MAVLink_home_position_message(
            round(lat_deg * 1e7),
            round(lon_deg * 1e7),
            alt_mm,
            0.0,
            0.0,
            0.0,
            [1.0, 0.0, 0.0, 0.0],
            0.0,
            0.0,
            0.0,
            round(self.up_s(now_s) * 1e6),
        )

    def _gps_global_origin(self, now_s: float) -> Any:
        lat_deg, lon_deg = self._home_geo()
        alt_mm = round(float(self._autopilot.home_m[2]) * 1e3)
        return mavlink.MAVLink_gps_global_origin_message(
            round(lat_deg * 1e7), round(lon_deg * 1e7), alt_mm, round(self.up_s(now_s) * 1e6)
        )

    def _system_time(self, now_s: float) -> Any:
        return mavlink.MAVLink_system_time_message(0, round(self.up_s(now_s) * 1e3))

    def _nav_controller_output(self, now_s: float) -> Any:
        del now_s
        target_m, motion = self._autopilot.target_m, self._motion()
        if target_m is None:
            return mavlink.MAVLink_nav_controller_output_message(0.0, 0.0, 0, 0, 0, 0.0, 0.0, 0.0)
        east, north, up = target_m - motion.position_m
        bearing = round(math.degrees(math.atan2(east, north)))
        distance_m = min(round(math.hypot(east, north)), _MAX_UINT16)
        return mavlink.MAVLink_nav_controller_output_message(0.0, 0.0, bearing, bearing, distance_m, up, 0.0, 0.0)

    def _ekf_status_report(self, now_s: float) -> Any:
        flags = _EKF_READY if now_s >= self._autopilot.ready_s else _EKF_ATTITUDE
        return mavlink.MAVLink_ekf_status_report_message(flags, 0.05, 0.05, 0.05, 0.05, 0.0)

    def _estimator_status(self, now_s: float) -> Any:
        flags = _EKF_READY if now_s >= self._autopilot.ready_s else _EKF_ATTITUDE
        return mavlink.MAVLink_estimator_status_message(
            round(self.up_s(now_s) * 1e6), flags, 0.05, 0.05, 0.05, 0.05, 0.0, 0.0, 0.3, 0.3
        )

    def _autopilot_version(self, now_s: float) -> Any:
        del now_s
        kind = self._autopilot.personality
        return mavlink.MAVLink_autopilot_version_message(
            kind.capabilities,
            kind.software_version,
            0,
            0,
            0,
            [0] * 8,
            [0] * 8,
            [0] * 8,
            0,
            0,
            self._sysid,  # a stable identity of its own for every simulated vehicle
        )

"""The standard message types: what each of their fields contains. Data, and nothing else.

A field that is a message and is not named here has the contents of its own type; one that is named
has this content throughout. A type or field that is missing is unknown: it cannot be shown at a
level (`describe`). The types are those of Debian's std, geometry, sensor, nav, tf2, stereo,
diagnostic, actionlib, trajectory and visualization packages, and the sound of audio_common.
"""

from collections.abc import Mapping
from typing import Final

from grants.vocabulary.contents import Fields, fields_by

_XYZ: Final = "x y z"
_BARE: Final = fields_by(bare="data")
_SCAN: Final = fields_by(
    format="angle_min angle_max angle_increment time_increment scan_time range_min range_max",
    distance="ranges intensities",
)
_NUMBERS: Final = (
    "Bool", "Byte", "Char", "Duration", "Float32", "Float64", "Int16", "Int32", "Int64", "Int8",
    "String", "UInt16", "UInt32", "UInt64", "UInt8",
)  # fmt: skip
_ARRAYS: Final = (
    "Byte", "Float32", "Float64", "Int16", "Int32", "Int64", "Int8", "UInt16", "UInt32", "UInt64",
    "UInt8",
)  # fmt: skip

_STD: Final[dict[str, Fields]] = {
    **{f"std_msgs/{name}": _BARE for name in _NUMBERS},
    **{f"std_msgs/{name}MultiArray": _BARE for name in _ARRAYS},
    "std_msgs/Header": fields_by(count="seq", time="stamp", frame="frame_id"),
    "std_msgs/Time": fields_by(time="data"),
    "std_msgs/Empty": {},
    "std_msgs/ColorRGBA": fields_by(reading="r g b a"),  # of a lamp
    # How many values there are is told without them, and a label may say anything.
    "std_msgs/MultiArrayLayout": fields_by(count="data_offset"),
    "std_msgs/MultiArrayDimension": fields_by(text="label", count="size stride"),
}
_GEOMETRY: Final[dict[str, Fields]] = {
    "geometry_msgs/Point": fields_by(coordinate=_XYZ),
    "geometry_msgs/Point32": fields_by(coordinate=_XYZ),
    "geometry_msgs/PointStamped": {},
    "geometry_msgs/Vector3": fields_by(bare=_XYZ),
    "geometry_msgs/Vector3Stamped": {},
    "geometry_msgs/Quaternion": fields_by(heading="x y z w"),
    "geometry_msgs/QuaternionStamped": {},
    "geometry_msgs/Pose": {},
    "geometry_msgs/Pose2D": fields_by(coordinate="x y", heading="theta"),
    "geometry_msgs/PoseStamped": {},
    "geometry_msgs/PoseArray": {},
    "geometry_msgs/PoseWithCovariance": fields_by(uncertainty="covariance"),
    "geometry_msgs/PoseWithCovarianceStamped": {},
    "geometry_msgs/Polygon": {},
    "geometry_msgs/PolygonStamped": {},
    "geometry_msgs/Transform": fields_by(coordinate="translation", heading="rotation"),
    "geometry_msgs/TransformStamped": fields_by(child_frame="child_frame_id"),
    "geometry_msgs/Twist": fields_by(velocity="linear angular"),
    "geometry_msgs/TwistStamped": {},
    "geometry_msgs/TwistWithCovariance": fields_by(uncertainty="covariance"),
    "geometry_msgs/TwistWithCovarianceStamped": {},
    "geometry_msgs/Accel": fields_by(velocity="linear angular"),
    "geometry_msgs/AccelStamped": {},
    "geometry_msgs/AccelWithCovariance": fields_by(uncertainty="covariance"),
    "geometry_msgs/AccelWithCovarianceStamped": {},
    "geometry_msgs/Wrench": fields_by(force="force torque"),
    "geometry_msgs/WrenchStamped": {},
    "geometry_msgs/Inertia": fields_by(mark="m com ixx ixy ixz iyy iyz izz"),
    "geometry_msgs/InertiaStamped": {},
}
_SENSOR: Final[dict[str, Fields]] = {
    "sensor_msgs/BatteryState": fields_by(
        charge="percentage",
        state="voltage temperature current charge power_supply_status present",
        wear="capacity power_supply_health cell_voltage cell_temperature",
        mark="design_capacity power_supply_technology",
        name="location serial_number",
    ),
    "sensor_msgs/CameraInfo": fields_by(
        mark="distortion_model D K R P", format="height width binning_x binning_y",
        picture_part="roi",
    ),
    "sensor_msgs/ChannelFloat32": fields_by(format="name", distance="values"),
    "sensor_msgs/CompressedImage": fields_by(format="format", compressed_picture="data"),
    "sensor_msgs/FluidPressure": fields_by(pressure="fluid_pressure", state="variance"),
    "sensor_msgs/Illuminance": fields_by(ambient_brightness="illuminance", state="variance"),
    "sensor_msgs/Image": fields_by(
        format="height width encoding is_bigendian step", picture="data"
    ),
    # The compass is in `orientation`; gyroscope and accelerometer give the path.
    "sensor_msgs/Imu": fields_by(
        velocity="angular_velocity linear_acceleration",
        uncertainty="orientation_covariance angular_velocity_covariance"
        " linear_acceleration_covariance",
    ),
    "sensor_msgs/JointState": fields_by(name="name", joint="position velocity effort"),
    "sensor_msgs/Joy": fields_by(control="axes buttons"),
    "sensor_msgs/JoyFeedback": fields_by(control="type id intensity"),
    "sensor_msgs/JoyFeedbackArray": {},
    "sensor_msgs/LaserEcho": fields_by(distance="echoes"),
    "sensor_msgs/LaserScan": _SCAN,
    "sensor_msgs/MultiEchoLaserScan": _SCAN,
    "sensor_msgs/MagneticField": fields_by(
        heading="magnetic_field", uncertainty="magnetic_field_covariance"
    ),
    "sensor_msgs/MultiDOFJointState": fields_by(name="joint_names"),
    # Whether there is a fix, and how good it is, tells indoors from outdoors.
    "sensor_msgs/NavSatFix": fields_by(
        degrees="latitude longitude", height="altitude",
        uncertainty="status position_covariance position_covariance_type",
    ),
    "sensor_msgs/NavSatStatus": fields_by(uncertainty="status service"),
    # The number of points changes with what is seen, so a cloud is cleared as a whole.
    "sensor_msgs/PointCloud": fields_by(distance="points"),
    "sensor_msgs/PointCloud2": fields_by(
        format="fields is_bigendian point_step", distance="height width row_step data is_dense"
    ),
    "sensor_msgs/PointField": fields_by(format="name offset datatype count"),
    "sensor_msgs/Range": fields_by(
        format="radiation_type field_of_view min_range max_range", distance="range"
    ),
    "sensor_msgs/RegionOfInterest": fields_by(
        picture_part="x_offset y_offset height width do_rectify"
    ),
    "sensor_msgs/RelativeHumidity": fields_by(
        ambient_humidity="relative_humidity", state="variance"
    ),
    "sensor_msgs/Temperature": fields_by(ambient_temperature="temperature", state="variance"),
    "sensor_msgs/TimeReference": fields_by(time="time_ref", name="source"),
}  # fmt: skip
_NAV: Final[dict[str, Fields]] = {
    "nav_msgs/GetMapAction": {},
    "nav_msgs/GetMapActionFeedback": {},
    "nav_msgs/GetMapActionGoal": {},
    "nav_msgs/GetMapActionResult": {},
    "nav_msgs/GetMapFeedback": {},
    "nav_msgs/GetMapGoal": {},
    "nav_msgs/GetMapResult": {},
    "nav_msgs/GridCells": fields_by(map="cell_width cell_height cells"),
    "nav_msgs/MapMetaData": fields_by(time="map_load_time", map="resolution width height origin"),
    "nav_msgs/OccupancyGrid": fields_by(map="data"),
    "nav_msgs/Odometry": fields_by(child_frame="child_frame_id"),
    "nav_msgs/Path": {},
}
_FURTHER: Final[dict[str, Fields]] = {
    "tf2_msgs/TFMessage": {},
    "tf2_msgs/TF2Error": fields_by(state="error", text="error_string"),
    "tf/tfMessage": {},
    "stereo_msgs/DisparityImage": fields_by(
        distance="image.data min_disparity max_disparity", mark="f T", format="delta_d",
        picture_part="valid_window",
    ),
    "diagnostic_msgs/DiagnosticArray": {},
    "diagnostic_msgs/DiagnosticStatus": fields_by(
        state="level", name="name hardware_id", text="message values"
    ),
    "diagnostic_msgs/KeyValue": fields_by(text="key value"),
    "actionlib_msgs/GoalID": fields_by(time="stamp", request="id"),
    "actionlib_msgs/GoalStatus": fields_by(state="status", text="text"),
    "actionlib_msgs/GoalStatusArray": {},
    "trajectory_msgs/JointTrajectory": fields_by(name="joint_names"),
    "trajectory_msgs/JointTrajectoryPoint": fields_by(
        joint="positions velocities accelerations effort time_from_start"
    ),
    "trajectory_msgs/MultiDOFJointTrajectory": fields_by(name="joint_names"),
    "trajectory_msgs/MultiDOFJointTrajectoryPoint": fields_by(velocity="time_from_start"),
    "shape_msgs/Mesh": fields_by(mark="triangles vertices"),
    "shape_msgs/MeshTriangle": fields_by(mark="vertex_indices"),
    "shape_msgs/Plane": fields_by(map="coef"),
    "shape_msgs/SolidPrimitive": fields_by(mark="type dimensions"),
    "visualization_msgs/Marker": fields_by(
        name="ns id", format="frame_locked mesh_use_embedded_materials",
        coordinate="points scale", state="type action lifetime color colors",
        text="text mesh_resource",
    ),
    "visualization_msgs/MarkerArray": {},
    "audio_common_msgs/AudioData": fields_by(samples="data"),
    "audio_common_msgs/AudioDataStamped": {},
    "audio_common_msgs/AudioInfo": fields_by(
        format="channels sample_rate sample_format bitrate coding_format"
    ),
}  # fmt: skip

TYPES: Final[Mapping[str, Fields]] = {**_STD, **_GEOMETRY, **_SENSOR, **_NAV, **_FURTHER}

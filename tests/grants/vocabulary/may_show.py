"""What may show of a message at each level below `exact`, and why. Data, and nothing else.

A second opinion on the tables of `grants.vocabulary`: a field that shows and is in no row is a
leak. Fields are patterns of the keys of `leaves`: with ` > ` of the whole key, else of its end.
"""

from typing import Final, NamedTuple

EVERY: Final = "position movement image sound presence identity home"


class Row(NamedTuple):
    """These fields may show at `levels` (of all: empty) of `words`, for this reason."""

    words: str
    levels: str
    reason: str
    fields: str


_ELSE: Final = "image sound presence identity home"

MAY_SHOW: Final = (
    Row(
        EVERY,
        "",
        "says how the rest is read, and is the same in every message of a device",
        "audio_common_msgs/AudioInfo.* sensor_msgs/CameraInfo.height sensor_msgs/CameraInfo.width "
        "sensor_msgs/CameraInfo.binning_[xy] sensor_msgs/CompressedImage.format "
        "sensor_msgs/Image.is_bigendian sensor_msgs/*LaserScan.angle_* "
        "sensor_msgs/*LaserScan.range_m?? sensor_msgs/*LaserScan.scan_time "
        "sensor_msgs/*LaserScan.time_increment sensor_msgs/PointCloud2.fields[[]*] "
        "sensor_msgs/PointCloud2.is_bigendian sensor_msgs/PointCloud2.point_step "
        "sensor_msgs/PointField.* sensor_msgs/ChannelFloat32.name sensor_msgs/Range.radiation_type "
        "sensor_msgs/Range.field_of_view sensor_msgs/Range.m??_range "
        "stereo_msgs/DisparityImage.delta_d visualization_msgs/Marker.frame_locked "
        "visualization_msgs/Marker.mesh_use_embedded_materials",
    ),
    Row(
        "position movement image sound presence home",
        "",
        "belongs to a body or a device, and does not change",
        "geometry_msgs/Inertia.* geometry_msgs/Inertia.com?>?* sensor_msgs/CameraInfo.[DKRP] "
        "sensor_msgs/CameraInfo.distortion_model sensor_msgs/BatteryState.design_capacity "
        "sensor_msgs/BatteryState.power_supply_technology shape_msgs/Mesh* "
        "shape_msgs/Mesh.vertices?>?* shape_msgs/SolidPrimitive.* stereo_msgs/DisparityImage.[fT]",
    ),
    Row(
        "position movement image sound presence home",
        "",
        "names a device or a part: not where it is, nor what it does",
        "sensor_msgs/BatteryState.location sensor_msgs/BatteryState.serial_number "
        "diagnostic_msgs/DiagnosticStatus.name diagnostic_msgs/DiagnosticStatus.hardware_id "
        "*.joint_names sensor_msgs/JointState.name visualization_msgs/Marker.ns "
        "visualization_msgs/Marker.id sensor_msgs/TimeReference.source",
    ),
    Row(
        "identity",
        "pseudonym",
        "a pseudonym of each receiver's own",
        "sensor_msgs/BatteryState.location sensor_msgs/BatteryState.serial_number "
        "diagnostic_msgs/DiagnosticStatus.name diagnostic_msgs/DiagnosticStatus.hardware_id "
        "visualization_msgs/Marker.ns sensor_msgs/TimeReference.source actionlib_msgs/GoalID.id "
        "*.frame_id *.child_frame_id",
    ),
    Row(
        "position movement image sound presence home",
        "",
        "the frame of what is shown; where the word is told it goes with it",
        "*.frame_id *.child_frame_id",
    ),
    Row(
        "position movement image sound identity home",
        "",
        "a moment alone; it never shows in a message that tells the word",
        "*.stamp *.seq std_msgs/Time.data sensor_msgs/TimeReference.time_ref "
        "nav_msgs/MapMetaData.map_load_time",
    ),
    Row(
        "position",
        "room area",
        "a cell with hysteresis",
        "geometry_msgs/Point*.[xyz] geometry_msgs/Pose2D.[xy] "
        "geometry_msgs/Transform.translation?>?* sensor_msgs/NavSatFix.l*itude "
        "visualization_msgs/Marker.scale?>?*",
    ),
    Row(
        "movement",
        "rough",
        "a cell with hysteresis",
        "geometry_msgs/Point*.[xyz] geometry_msgs/Pose2D.[xy] "
        "geometry_msgs/Transform.translation?>?* visualization_msgs/Marker.scale?>?* "
        "geometry_msgs/Twist.*?>?* geometry_msgs/Accel.*?>?* sensor_msgs/Imu.[al]*_*?>?* "
        "sensor_msgs/NavSatFix.l*itude",
    ),
    Row("position movement", "", "the colour of a lamp, on a topic of its own", "std_msgs/ColorRGBA.?"),
    Row(
        "position movement home",
        "room rough",
        "so coarse that a room is the most it tells",
        "sensor_msgs/Temperature.temperature sensor_msgs/RelativeHumidity.relative_humidity "
        "sensor_msgs/Illuminance.illuminance",
    ),
    Row(
        "position movement home",
        "room area rough",
        "in quarters it does not tell the dock",
        "sensor_msgs/BatteryState.percentage",
    ),
    Row(
        "home",
        "rough",
        "a step of 83 m of height, or of the weather",
        "sensor_msgs/FluidPressure.fluid_pressure",
    ),
    Row(
        _ELSE,
        "",
        "a place, a way or a body's movement tells no picture, sound, moment, name or state of the home",
        "geometry_msgs/* nav_msgs/Path.* tf2_msgs/TFMessage.* tf/tfMessage.* trajectory_msgs/* "
        "sensor_msgs/Imu.* sensor_msgs/J* sensor_msgs/MagneticField.* "
        "sensor_msgs/MultiDOFJointState.* sensor_msgs/NavSat*.* "
        "visualization_msgs/Marker.points[[]*] visualization_msgs/Marker.points?>?* "
        "visualization_msgs/Marker.scale?>?*",
    ),
    Row(
        "image sound presence identity",
        "",
        "a map, a number or a state tells no picture, sound, moment or name",
        "nav_msgs/GridCells.* nav_msgs/MapMetaData.* nav_msgs/OccupancyGrid.data "
        "shape_msgs/Plane.coef sensor_msgs/FluidPressure.* sensor_msgs/Illuminance.* "
        "sensor_msgs/RelativeHumidity.* sensor_msgs/Temperature.* std_msgs/ColorRGBA.? "
        "actionlib_msgs/GoalStatus*.status* diagnostic_msgs/DiagnosticArray.status[[]*] "
        "diagnostic_msgs/DiagnosticStatus.level tf2_msgs/TF2Error.error "
        "visualization_msgs/Marker*.[aclmt]*",
    ),
    Row(
        "image sound presence identity",
        "",
        "a state of the battery tells no picture, sound or"
        " moment, and what it shares with others of its kind no name",
        "sensor_msgs/BatteryState.percentage sensor_msgs/BatteryState.voltage "
        "sensor_msgs/BatteryState.temperature sensor_msgs/BatteryState.c[uh]* "
        "sensor_msgs/BatteryState.power_supply_status sensor_msgs/BatteryState.present",
    ),
    Row(
        "image sound presence",
        "",
        "how a battery has aged tells no picture, sound or moment",
        "sensor_msgs/BatteryState.capacity sensor_msgs/BatteryState.power_supply_health "
        "sensor_msgs/BatteryState.cell_*",
    ),
    Row(
        "sound presence identity",
        "",
        "what rays measured tells no sound, moment or name",
        "sensor_msgs/*LaserScan.ranges* sensor_msgs/*LaserScan.intensities* "
        "sensor_msgs/LaserEcho.echoes sensor_msgs/PointCloud*.* sensor_msgs/ChannelFloat32.values "
        "sensor_msgs/Range.range stereo_msgs/DisparityImage.m??_disparity "
        "stereo_msgs/DisparityImage.image?>?sensor_msgs/Image.data",
    ),
    Row(
        "sound presence",
        "",
        "a picture makes no sound; of its moment only the arrival tells",
        "sensor_msgs/Image.data sensor_msgs/CompressedImage.data sensor_msgs/RegionOfInterest.*",
    ),
    Row("image", "blurred", "at most 16 squares across", "sensor_msgs/Image.data"),
    Row(
        "image presence",
        "",
        "sound shows nobody; of its moment only the arrival tells",
        "audio_common_msgs/AudioData.data",
    ),
    Row(
        "image sound identity home",
        "",
        "sizes of an array whose values are named by the topic",
        "std_msgs/MultiArray*",
    ),
)

"""Bags of rendered recordings, of all three kinds, with calibration in messages or beside."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.frontend.studio import cameras, pair
from vislam.geometry import se3
from vislam.models.camera import Lens

KINDS = ("bag", "db3", "mcap")
TOPICS = ("/cam0/image_raw", "/cam1/image_raw")
IMU = "/imu0"


class Pen:
    """Writes messages of ROS 1 or ROS 2 into a bag."""

    def __init__(self, folder, kind, name="run"):
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.one = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.one else Stores.ROS2_HUMBLE)
        if self.one:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        folder.mkdir(parents=True, exist_ok=True)
        if self.one:
            self.path = folder / f"{name}.bag"
            self.writer = Writer1(self.path)
        else:
            self.path = folder / name
            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            self.writer = Writer(self.path, version=9, storage_plugin=plugin)
        self.connections = {}

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *_):
        self.writer.close()

    def type(self, name):
        package, _, kind = name.partition("/")
        return self.store.types[f"{package}/msg/{kind}"]

    def header(self, stamp, frame=""):
        time = self.type("builtin_interfaces/Time")(sec=stamp // 10**9, nanosec=stamp % 10**9)
        more = {"seq": 0} if self.one else {}
        return self.type("std_msgs/Header")(**more, stamp=time, frame_id=frame)

    def write(self, topic, arrived, message):
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.one else self.store.serialize_cdr
        self.writer.write(self.connections[topic], arrived, serialize(message, kind))

    def image(self, stamp, pixels, encoding="mono8", frame="", step=None):
        rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)
        return self.type("sensor_msgs/Image")(
            header=self.header(stamp, frame),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1] if step is None else step,
            data=rows.ravel(),
        )

    def compressed(self, stamp, content):
        return self.type("sensor_msgs/CompressedImage")(
            header=self.header(stamp), format="png", data=np.frombuffer(content, np.uint8)
        )

    def vector(self, values):
        return self.type("geometry_msgs/Vector3")(**dict(zip("xyz", map(float, values), strict=True)))

    def imu(self, stamp, gyro, accelerometer, frame="imu"):
        none = np.zeros(9)
        return self.type("sensor_msgs/Imu")(
            header=self.header(stamp, frame),
            orientation=self.type("geometry_msgs/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=none,
            angular_velocity=self.vector(gyro),
            angular_velocity_covariance=none,
            linear_acceleration=self.vector(accelerometer),
            linear_acceleration_covariance=none,
        )

    def info(self, stamp, camera, turn, projection, frame=""):
        matrix = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
        names = dict(zip("dkrp", ("D", "K", "R", "P") if self.one else "dkrp", strict=True))
        return self.type("sensor_msgs/CameraInfo")(
            header=self.header(stamp, frame),
            height=camera.height,
            width=camera.width,
            distortion_model="equidistant" if camera.lens is Lens.KANNALA_BRANDT else "plumb_bob",
            **{
                names["d"]: np.array(camera.coefficients),
                names["k"]: np.array(matrix),
                names["r"]: np.ravel(turn),
                names["p"]: np.ravel(projection),
            },
            binning_x=0,
            binning_y=0,
            roi=self.type("sensor_msgs/RegionOfInterest")(
                x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
            ),
        )

    def transform(self, parent, child, pose):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        one = self.type("geometry_msgs/TransformStamped")(
            header=self.header(0, parent),
            child_frame_id=child,
            transform=self.type("geometry_msgs/Transform")(
                translation=self.vector(pose[:3, 3]),
                rotation=self.type("geometry_msgs/Quaternion")(x=x, y=y, z=z, w=w),
            ),
        )
        return self.type("tf2_msgs/TFMessage")(transforms=[one])


def samples(stamps):
    """What :func:`tests.frontend.studio.write_asl` writes into ``imu0``."""
    return np.arange(stamps[0] - 10**8, stamps[-1] + 10**8, 5 * 10**6).tolist()


def write_camchain(path, topics=TOPICS, rig=None):
    left, right, imu_T_left, imu_T_right = cameras() if rig is None else rig
    text = ""
    for name, camera, imu_T_cam, topic in zip(
        ("cam0", "cam1"), (left, right), (imu_T_left, imu_T_right), topics, strict=True
    ):
        text += (
            f"{name}:\n  camera_model: pinhole\n  distortion_model: radtan\n"
            f"  distortion_coeffs: {list(camera.coefficients)}\n"
            f"  intrinsics: [{camera.fx}, {camera.fy}, {camera.cx}, {camera.cy}]\n"
            f"  resolution: [{camera.width}, {camera.height}]\n  rostopic: {topic}\n"
            "  timeshift_cam_imu: 0.0\n  T_cam_imu:\n"
        ) + "".join(f"  - {row}\n" for row in se3.inverse(imu_T_cam).tolist())
    path.write_text(text)


def write_bag(
    folder, kind, made, *, content=None, camchain=True, topics=TOPICS, arrival=None, header=True, imu=True
):
    """Write a bag with the images and inertial samples of a drive.

    ``content`` makes the message of an image out of pen, stamp and picture; ``arrival`` is the place in the
    order of arrival of each frame.
    """
    stamps = np.rint(1e9 * made.stamp).astype(np.int64).tolist()
    content = content or (lambda pen, stamp, picture: pen.image(stamp, picture))
    with Pen(folder, kind) as pen:
        if camchain:
            write_camchain(folder / "camchain-imucam-run.yaml", topics)
        else:
            _write_calibration(pen, stamps[0], topics)
        if imu:
            for stamp in samples(stamps):
                pen.write(IMU, stamp, pen.imu(stamp, (0.0, 0.0, 0.08), (0.0, 0.0, 9.81)))
        for frame in range(len(stamps)):
            at = stamps[0] + 10**8 * (frame if arrival is None else arrival[frame])
            for side, topic in enumerate(topics):
                stamp = stamps[frame] if header else 0
                pen.write(topic, at, content(pen, stamp, made.pictures[frame][side]))
    return pen.path


def _write_calibration(pen, stamp, topics):
    left, right, imu_T_left, _ = cameras()
    made = pair()
    rig = made.rig
    for topic, camera, turn, frame, shift in (
        (topics[0], left, made.rect_R_left, "left", 0.0),
        (topics[1], right, made.rect_R_right, "right", -rig.fx * rig.baseline),
    ):
        projection = [[rig.fx, 0.0, rig.cx, shift], [0.0, rig.fy, rig.cy, 0.0], [0.0, 0.0, 1.0, 0.0]]
        name = f"{topic.removesuffix('/compressed').rpartition('/')[0]}/camera_info"
        pen.write(name, stamp, pen.info(stamp, camera, turn, projection, frame))
    pen.write("/tf_static", stamp, pen.transform("base", "imu", np.eye(4)))
    pen.write("/tf_static", stamp, pen.transform("base", "left", imu_T_left))

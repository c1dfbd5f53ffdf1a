"""The toy pair without distortion as other programs write it, in the formats that are only read."""

import json

from toy_stereo import SIZE

DEPTHAI = "calib.json"
ZED = "SN1.conf"
KITTI = "calib_cam_to_cam.txt"
EUROC = ("cam0/sensor.yaml", "cam1/sensor.yaml")
MIDDLEBURY = "calib.txt"


def foreign_calibrations(
    size: tuple[int, int] = SIZE, focal_px: float = 230.0, baseline_m: float = 0.12
) -> dict[str, str]:
    """Text by the path of the file. A ZED has images of its own sizes: this one is 672 x 376."""
    (width, height), f = size, focal_px
    cx, cy = (width - 1) / 2, (height - 1) / 2
    matrix = [[f, 0, cx], [0, f, cy], [0, 0, 1]]
    cameras = []
    for socket, to, shift_cm in ((1, 2, -100 * baseline_m), (2, -1, 0.0)):
        link = {
            "rotationMatrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
            "translation": {"x": shift_cm, "y": 0, "z": 0},
            "toCameraSocket": to,
        }
        own = {"width": width, "height": height, "intrinsicMatrix": matrix, "distortionCoeff": [0] * 14}
        cameras.append([socket, own | {"cameraType": 0, "extrinsics": link}])
    zed = "".join(f"[{side}_CAM_VGA]\nfx={f}\nfy={f}\ncx=336\ncy=188\n" for side in ("LEFT", "RIGHT"))
    kitti = "".join(
        f"S_{name}: {width} {height}\nK_{name}: {f} 0 {cx} 0 {f} {cy} 0 0 1\nD_{name}: 0 0 0 0 0\n"
        f"R_{name}: 1 0 0 0 1 0 0 0 1\nT_{name}: {shift_m} 0 0\n"
        for name, shift_m in (("00", 0.0), ("01", -baseline_m))
    )
    euroc = [
        f"sensor_type: camera\nT_BS: {{cols: 4, rows: 4, data: [1, 0, 0, {x_m}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}}\n"
        f"camera_model: pinhole\nintrinsics: [{f}, {f}, {cx}, {cy}]\ndistortion_model: radial-tangential\n"
        f"distortion_coefficients: [0, 0, 0, 0]\nresolution: [{width}, {height}]\n"
        for x_m in (0.0, baseline_m)
    ]
    middlebury = "".join(f"cam{i}=[{f} 0 {cx}; 0 {f} {cy}; 0 0 1]\n" for i in (0, 1))
    return {
        DEPTHAI: json.dumps({"cameraData": cameras}),
        ZED: f"{zed}[STEREO]\nBaseline={1000 * baseline_m}\n",
        KITTI: f"calib_time: 09-Jan-2012 13:57:47\n{kitti}",
        **dict(zip(EUROC, euroc, strict=True)),
        MIDDLEBURY: f"{middlebury}doffs=0\nbaseline={1000 * baseline_m}\nwidth={width}\nheight={height}\n",
    }

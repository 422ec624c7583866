"""Recordings of Clement et al. (2015): MATLAB files with tracks of another front end, as course files."""

import numpy as np
from scipy.io import loadmat

from tests.conftest import recorded


def converted(name, folder):
    """Path of a course file made from a ``.mat`` file; skips the test where that is missing."""
    mat = loadmat(recorded(f"clement2015/{name}.mat"))
    frames = mat["y_k_j"].shape[1]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = mat["C_c_v"].T, mat["rho_v_c_v"].ravel()
    fu, fv, cu, cv = (mat[key].item() for key in ("fu", "fv", "cu", "cv"))
    np.savez(
        folder / f"{name}.npz",
        time_stamps=mat["t"][:, :frames],
        features=np.transpose(mat["y_k_j"], (0, 2, 1)),
        linear_velocity=mat["v_vk_vk_i"][:, :frames],
        angular_velocity=mat["w_vk_vk_i"][:, :frames],
        K=np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1.0]]),
        b=np.array(mat["b"].item()),
        imu_T_cam=pose,
    )
    return folder / f"{name}.npz"

"""Motion of a stereo pair from matched points: RANSAC, then robust Gauss-Newton on the reprojection error.

The residual is taken in both current images, and its weight carries the error of the previous images through the
point they define, so that the solution is that of the joint problem in motion and points (a point and its three
previous image coordinates determine each other; the dependence is linear within 1e-4 px of noise).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.matching import Matches
from estimators.stereo_geometry import project, projection_jacobian, triangulate
from sensors.rig import StereoCalibration
from vehicle.frames import FloatArray, orthonormalised, so3_exp, transform

_HYPOTHESES = 50  # de Saxe 2018, section 3.1
_GATE = 1.5  # reprojection error of an inlier of a hypothesis [px]
_PIXEL_STD = 0.1  # of one tracked coordinate; only starts the robust weights, the residuals give the real one [px]
_HUBER = 1.5  # [sigma of one coordinate]
_CUT = 4.0  # matches beyond this are dropped at the end [sigma of one coordinate]
_ITERATIONS = 8
_CONVERGED = 1e-6  # [rad, m]
_ROW_WEIGHT = np.diag([1.0, 0.5, 1.0])  # v is the mean of two rows


class Solution(NamedTuple):
    """A motion, its covariance (as ``estimates.Motion`` has it) and the matches it rests on."""

    X_PC: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6)
    inliers: NDArray[np.bool_]  # (n,)
    converged: bool


def _minimal(cal, p, z, X0, iterations=4):
    """Gauss-Newton for (b,3,3) points"""
    R = np.broadcast_to(X0[:3,:3], (len(p),3,3)).copy(); t = np.broadcast_to(X0[:3,3], (len(p),3)).copy()
    for _ in range(iterations):
        J, r = _linear(cal, p, z, R[:, None], t[:, None])
        A = J.reshape(len(p), -1, 6); At = A.transpose(0,2,1)
        d = np.linalg.solve(At@A + 1e-6*np.eye(6), At@r.reshape(len(p),-1,1))[...,0]
        R = _exp(d[:, :3]) @ R; t = t + d[:, 3:]
    return R, t

def _linear(cal, p, z, R, t):
    """J (...,3,6) of projection wrt (dtheta, dt), residual"""
    Rt = np.swapaxes(R, -1, -2)
    q = p - t
    y = (Rt @ q[..., None])[..., 0]
    y = np.concatenate([y[..., :2], np.maximum(y[..., 2:], 0.1)], -1)
    Jp = projection_jacobian(cal, y) @ Rt
    S = np.zeros((*q.shape, 3)); S[...,0,1]=-q[...,2]; S[...,0,2]=q[...,1]; S[...,1,0]=q[...,2]; S[...,1,2]=-q[...,0]; S[...,2,0]=-q[...,1]; S[...,2,1]=q[...,0]
    return np.concatenate([Jp@S, -Jp], -1), z - project(cal, y)

def _exp(w):
    a = np.linalg.norm(w, axis=1)[:,None,None]+1e-12
    K = np.zeros((len(w),3,3)); K[:,0,1]=-w[:,2];K[:,0,2]=w[:,1];K[:,1,0]=w[:,2];K[:,1,2]=-w[:,0];K[:,2,0]=-w[:,1];K[:,2,1]=w[:,0]
    return np.eye(3)+np.sin(a)/a*K+(1-np.cos(a))/a**2*(K@K)

def ransac(cal, p, z, X0, rng):
    n=len(p)
    idx = rng.integers(0, n, (_HYPOTHESES, 3))
    R, t = _minimal(cal, p[idx], z[idx], X0)
    R = np.concatenate([R, X0[None,:3,:3]]); t = np.concatenate([t, X0[None,:3,3]])
    y = np.einsum('bji,bnj->bni', R, p[None]-t[:,None])
    y[...,2]=np.maximum(y[...,2],.1)
    e = ((z - project(cal, y))**2).sum(-1)
    k = np.minimum(e, _GATE**2).sum(1).argmin()
    return transform(R[k], t[k]), e[k] < _GATE**2

def refine(cal, p, z_P, z, X, inl, weights=None, s=_PIXEL_STD, iters=_ITERATIONS):
    R,t = X[:3,:3],X[:3,3]
    p, z = p[inl], z[inl]
    Ji = np.linalg.inv(projection_jacobian(cal, p))
    D = np.broadcast_to(_ROW_WEIGHT,(len(p),3,3)) if weights is None else weights[inl][:,None,None]*_ROW_WEIGHT
    for k in range(iters):
        J, r = _linear(cal, p, z, R, t)
        B = -J[..., 3:] @ Ji
        C = D + B@D@B.transpose(0,2,1)
        W = np.linalg.inv(C)
        m2 = np.einsum('ni,nij,nj->n', r, W, r)/3
        m = np.sqrt(m2)
        s = max(0.02, 1.4826*np.median(m)/1.31) if k else s
        w = np.minimum(1, _HUBER/np.maximum(m/s,1e-9)); 
        if k>=3: w = np.where(m>_CUT*s, 0, w)
        A = J.transpose(0,2,1)@(w[:,None,None]*W)
        H = (A@J).sum(0); g=(A@r[...,None]).sum(0)[:,0]
        d = np.linalg.solve(H,g)
        R = so3_exp(d[:3])@R; t=t+d[3:]
        if k>=4 and np.abs(d).max()<_CONVERGED: break
    ok = m<=_CUT*s
    s2 = (w*m2*3).sum()/max(1,(3*ok.sum()-6))
    return transform(orthonormalised(R),t), np.linalg.inv(H)*s2, ok, np.sqrt(s2), m

"""Rigid transforms, cameras and rays: pure functions over float64 numpy arrays, batched, no state.

Conventions, stated once for the whole project:

* ``T_a_b`` is a 4x4 matrix that maps points of frame b into frame a.
* A tangent vector is ``(rotation, translation)``: three radians, then three metres.
* Perturbations act on the **right**: ``T = T_mean @ exp(xi)``, so a covariance is in the body's own axes.
* Cameras use OpenGL axes (x right, y up, looking along -z); pixel centres lie at +0.5.
* Worlds have z up; metres, seconds, radians.
"""

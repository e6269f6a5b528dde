"""Coordinate frames of the paper, as types.

A frame exists for the type checker only: `Pose[Tcp, Hc]` is the pose of the hand-eye camera in
the tool centre point, written `T_tcp_hc`. Camera frames are optical: z forward, x right, y down.
"""

from __future__ import annotations


class Frame:
    """Base of all frames; never instantiated."""


class W(Frame):
    """World of the visual-inertial odometry: z up, origin where it started."""


class Platform(Frame):
    """Swinging platform: x forward, y left, z up."""


class Base(Frame):
    """Base of the arm, as its manufacturer defines it."""


class Tcp(Frame):
    """Tool centre point of the arm: z along the tool."""


class Cam(Frame):
    """A camera, where it does not matter which."""


class Hc(Cam):
    """Hand-eye camera (the paper's CAM2, `hc`)."""


class Mako(Cam):
    """Eye-to-hand camera on the platform (the paper's CAM1, `mako`)."""


class Object(Frame):
    """An object of the database, in the frame its mesh is drawn in."""


class Tag(Frame):
    """A marker: x right, y up, z out of the printed face, origin in its centre."""


class Target(Tag):
    """The target marker of an object, the paper's `x`."""

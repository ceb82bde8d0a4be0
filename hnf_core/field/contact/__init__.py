"""Contact over time: pressing, taps, stick–slip, and the motion of the probe over a measured relief.

`contact_filter` is the linear contact for slow changes of force, `taps` the whole contact along the normal for fast
ones, `stick_slip` friction's motion along a slow stroke, `contact_motion` the whole contact over a known relief.
"""

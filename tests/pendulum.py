"""A model to draw: a pendulum, a goal and a marker."""

PENDULUM = """
<mujoco>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="front" pos="0 -2 0" xyaxes="1 0 0 0 0 1"/>
    <site name="goal" pos=".4 0 .4" size=".1" rgba="1 0 0 -1"/>
    <site name="marker" pos="-.4 0 .4" size=".1" rgba="0 1 0 1"/>
    <body>
      <joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".05" group="1"/>
      <geom type="sphere" pos=".4 0 -.4" size=".2" group="0" rgba="0 0 1 1"/>
    </body>
  </worldbody>
</mujoco>
"""

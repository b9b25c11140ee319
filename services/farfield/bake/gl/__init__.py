"""OpenGL through EGL, without X: records what `farfield.bake.coverage` records, on a graphics card."""

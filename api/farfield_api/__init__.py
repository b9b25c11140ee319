"""The HTTP API of farfield: a thin FastAPI shell over `farfield`."""

"""HTTP in, rows and messages out: the FastAPI shell around the store."""

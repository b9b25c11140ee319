"""Rows and blobs in, rows and blobs out: the only package with SQL, and the artifacts under their digests."""

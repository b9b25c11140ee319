"""The only package with SQL and blobs: tables, repositories, artifacts by digest."""

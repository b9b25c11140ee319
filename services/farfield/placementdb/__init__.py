"""Everything -> files: manifest, chunks and pages that the viewer reads."""

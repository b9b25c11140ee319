"""What `farfield.pipeline` lists: how each stage is asked, cut into shards, run and joined. Nothing here knows another stage."""

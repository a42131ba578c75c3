"""What the web UI shows: assets, checks, jobs, the sensor, and the bodies that runs execute."""

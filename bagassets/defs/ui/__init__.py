"""What `bagassets ui` starts: web server, daemon, and who may reach them."""

"""What turns a plan into what the outside world understands: mission items, files, MAVLink."""

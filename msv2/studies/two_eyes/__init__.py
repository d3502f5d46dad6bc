"""What a second eye costs on a machine with super-tiles that renders both eyes from one set of lists (`spec.joint`)."""

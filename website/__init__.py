"""The site: pages made of the code, what MkDocs does beside reading docs/, and the reader of prose."""

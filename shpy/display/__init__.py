"""Pictures of programs and streams: inputs that are filled by name, outputs as pixels, and PNG files.

Stage: picture, below programs and streams, which notebooks show as their pictures.
"""

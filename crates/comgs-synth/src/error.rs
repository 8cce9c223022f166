//! What can go wrong.

use thiserror::Error;

/// Why a recipe was not rendered.
#[derive(Debug, Error)]
pub enum SynthError {
    /// The recipe cannot be rendered; every problem found, each with the path to its place in the record.
    #[error("the recipe has {} problem(s):\n  {}", .0.len(), .0.join("\n  "))]
    Recipe(Vec<String>),
    /// The JSON is not a recipe.
    #[error("not a recipe: {0}")]
    Json(#[from] serde_json::Error),
    /// No built-in recipe of that name.
    #[error("no built-in recipe is called {name:?}; there are {}", known.join(", "))]
    UnknownBuiltin {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: Vec<&'static str>,
    },
    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] comgs_image::WriteError),
    /// The target folder already holds something.
    #[error("the folder is not empty; a root is written into a new or empty folder: {}", .0.display())]
    NotEmpty(std::path::PathBuf),
    /// The caller asked to stop.
    #[error("stopped")]
    Stopped,
}

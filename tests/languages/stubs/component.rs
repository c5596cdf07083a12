//! #[derive(Component)], which does nothing here.
extern crate proc_macro;

#[proc_macro_derive(Component)]
pub fn component(_: proc_macro::TokenStream) -> proc_macro::TokenStream {
    proc_macro::TokenStream::new()
}

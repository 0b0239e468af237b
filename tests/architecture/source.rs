//! The source of the crate: its files, modules and imports.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::Visit;
use syn::{Item, UseTree};

use super::WINDOW_CRATES;

/// A module of the crate: a file, or a part of one.
#[derive(Default)]
pub struct Module {
    /// Number of its file.
    pub file: usize,
    /// Names of the items that it defines.
    pub items: BTreeSet<String>,
    /// What its `use` declarations bind: name and path.
    pub bindings: BTreeMap<String, Vec<String>>,
    /// Paths that it imports with a star.
    pub globs: Vec<Vec<String>>,
}

/// A path mentioned in a file.
pub struct Mention {
    pub module: String,
    pub path: Vec<String>,
    pub line: usize,
}

/// The source of the crate: files and modules, by their path below the crate, such as `optics::psf`.
#[derive(Default)]
pub struct House {
    pub files: Vec<PathBuf>,
    pub modules: BTreeMap<String, Module>,
    pub mentions: Vec<Mention>,
    pub violations: Vec<String>,
}

/// The path of the module of a file, relative to `src`.
pub fn module_of(path: &Path) -> String {
    let names: Vec<_> = path.iter().map(|name| name.to_string_lossy().trim_end_matches(".rs").to_owned()).collect();
    let names = if names.last().is_some_and(|name| name == "mod") { &names[..names.len() - 1] } else { &names[..] };
    let name = names.join("::");
    if name == "lib" { String::new() } else { name }
}

pub fn joined(module: &str, name: &str) -> String {
    if module.is_empty() { name.to_owned() } else { format!("{module}::{name}") }
}

pub fn is_test(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.meta.require_list().is_ok_and(|list| list.tokens.to_string() == "test")
    })
}

/// The leaves of a `use` tree: the path and the name that it binds. A star binds "*".
pub fn leaves(tree: &UseTree, before: &[String], found: &mut Vec<(Vec<String>, String)>) {
    let with = |name: &syn::Ident| before.iter().cloned().chain([name.to_string()]).collect::<Vec<_>>();
    match tree {
        UseTree::Path(path) => leaves(&path.tree, &with(&path.ident), found),
        UseTree::Name(name) if name.ident == "self" => {
            found.push((before.to_vec(), before.last().cloned().unwrap_or_default()));
        }
        UseTree::Name(name) => found.push((with(&name.ident), name.ident.to_string())),
        UseTree::Rename(rename) => found.push((with(&rename.ident), rename.rename.to_string())),
        UseTree::Glob(_) => found.push((before.to_vec(), "*".to_owned())),
        UseTree::Group(group) => group.items.iter().for_each(|tree| leaves(tree, before, found)),
    }
}

/// Collector of the mentions in the items of one module.
struct Reader<'a> {
    house: &'a mut House,
    file: usize,
    module: String,
    is_folder: bool,
}

impl Reader<'_> {
    fn mention(&mut self, path: Vec<String>, line: usize) {
        let module = self.module.clone();
        self.house.mentions.push(Mention { module, path, line });
    }

    fn define(&mut self, name: &syn::Ident) {
        if let Some(module) = self.house.modules.get_mut(&self.module) {
            module.items.insert(name.to_string());
        }
    }

    /// Paths in the tokens of a macro call, which are not parsed.
    fn tokens(&mut self, tokens: TokenStream) {
        let mut path: Vec<String> = Vec::new();
        let (mut colons, mut line) = (0, 0);
        for token in tokens {
            match token {
                TokenTree::Ident(ident) if path.is_empty() || colons == 2 => {
                    line = ident.span().start().line;
                    path.push(ident.to_string());
                    colons = 0;
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' && !path.is_empty() => colons += 1,
                other => {
                    if path.len() > 1 {
                        self.mention(std::mem::take(&mut path), line);
                    }
                    path.clear();
                    colons = 0;
                    if let TokenTree::Ident(ident) = &other {
                        path.push(ident.to_string());
                    }
                    if let TokenTree::Group(group) = other {
                        self.tokens(group.stream());
                    }
                }
            }
        }
        if path.len() > 1 {
            self.mention(path, line);
        }
    }
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        let (name, attributes) = match item {
            Item::Mod(module) => (Some(&module.ident), &module.attrs),
            Item::Fn(item) => (Some(&item.sig.ident), &item.attrs),
            Item::Struct(item) => (Some(&item.ident), &item.attrs),
            Item::Enum(item) => (Some(&item.ident), &item.attrs),
            Item::Trait(item) => (Some(&item.ident), &item.attrs),
            Item::Type(item) => (Some(&item.ident), &item.attrs),
            Item::Const(item) => (Some(&item.ident), &item.attrs),
            Item::Static(item) => (Some(&item.ident), &item.attrs),
            Item::Use(item) => (None, &item.attrs),
            Item::Impl(item) => (None, &item.attrs),
            _ => return syn::visit::visit_item(self, item),
        };
        if is_test(attributes) {
            return;
        }
        match item {
            Item::Mod(module) => {
                let Some((_, items)) = &module.content else { return };
                let inner = joined(&self.module, &module.ident.to_string());
                self.house.modules.insert(inner.clone(), Module { file: self.file, ..Module::default() });
                let outer = std::mem::replace(&mut self.module, inner);
                for item in items {
                    self.visit_item(item);
                }
                self.module = outer;
            }
            Item::Use(item) => {
                let mut found = Vec::new();
                leaves(&item.tree, &[], &mut found);
                let is_export = !matches!(item.vis, syn::Visibility::Inherited);
                let line = item.use_token.span.start().line;
                for (path, name) in found {
                    // A re-export by a folder is not an import of its own.
                    if !(is_export && self.is_folder) {
                        self.mention(path.clone(), line);
                    }
                    let module = self.house.modules.get_mut(&self.module).expect("it is being read");
                    if name == "*" { module.globs.push(path) } else { drop(module.bindings.insert(name, path)) }
                }
            }
            _ => {
                if let Some(name) = name {
                    self.define(name);
                }
                syn::visit::visit_item(self, item);
            }
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Vec<String> = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        let line = path.segments.first().map_or(0, |segment| segment.ident.span().start().line);
        if names.len() > 1 {
            self.mention(names, line);
        }
        syn::visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.tokens(call.tokens.clone());
        syn::visit::visit_macro(self, call);
    }
}

/// All identifiers of a token stream with their lines.
pub fn identifiers(tokens: TokenStream, found: &mut Vec<(String, usize)>) {
    for token in tokens {
        match token {
            TokenTree::Ident(ident) => found.push((ident.to_string(), ident.span().start().line)),
            TokenTree::Group(group) => identifiers(group.stream(), found),
            _ => {}
        }
    }
}

impl House {
    /// The house of these files, by their paths relative to `src`.
    pub fn of(sources: &[(PathBuf, String)]) -> Self {
        let mut house = Self::default();
        for (file, (path, _)) in sources.iter().enumerate() {
            house.files.push(path.clone());
            house.modules.insert(module_of(path), Module { file, ..Module::default() });
        }
        for (file, (path, source)) in sources.iter().enumerate() {
            let parsed = syn::parse_file(source).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            let is_folder = path.ends_with("mod.rs") || path.ends_with("lib.rs");
            let mut reader = Reader { house: &mut house, file, module: module_of(path), is_folder };
            for item in &parsed.items {
                reader.visit_item(item);
            }
            house.check_crates(path, source);
        }
        house
    }

    fn check_crates(&mut self, path: &Path, source: &str) {
        if path.starts_with("studio") {
            return;
        }
        let mut found = Vec::new();
        identifiers(source.parse().expect("it was parsed before"), &mut found);
        for (name, line) in found.iter().filter(|(name, _)| WINDOW_CRATES.contains(&name.as_str())) {
            self.violations.push(format!("{}:{line}: only studio may name {name}", path.display()));
        }
    }

    /// The file that defines the target of a path in a module; `None` for other crates, and for modules themselves.
    fn resolve(&self, module: &str, path: &[String], depth: usize) -> Option<usize> {
        let (first, rest) = path.split_first()?;
        if depth > 32 {
            return None;
        }
        match first.as_str() {
            "crate" | "lenslet_studio" => self.walk("", rest, depth),
            "self" => self.walk(module, rest, depth),
            "super" => self.resolve_above(module, rest, depth),
            // A name bound or defined here. Other names belong to other crates.
            _ => self.walk(module, path, depth),
        }
    }

    fn resolve_above(&self, module: &str, rest: &[String], depth: usize) -> Option<usize> {
        let above = module.rsplit_once("::").map_or("", |(above, _)| above);
        match rest.first().map(String::as_str) {
            Some("super") => self.resolve_above(above, &rest[1..], depth),
            _ => self.walk(above, rest, depth),
        }
    }

    fn walk(&self, start: &str, path: &[String], depth: usize) -> Option<usize> {
        let (first, rest) = path.split_first()?;
        let module = self.modules.get(start)?;
        let inner = joined(start, first);
        if self.modules.contains_key(&inner) {
            return if rest.is_empty() { None } else { self.walk(&inner, rest, depth) };
        }
        if module.items.contains(first) {
            return Some(module.file);
        }
        if let Some(bound) = module.bindings.get(first) {
            let whole: Vec<String> = bound.iter().chain(rest).cloned().collect();
            // A name bound to a path that starts with the same name belongs to another crate.
            return if bound.first() == Some(first) { None } else { self.resolve(start, &whole, depth + 1) };
        }
        module.globs.iter().find_map(|glob| {
            let whole: Vec<String> = glob.iter().chain(path).cloned().collect();
            self.resolve(start, &whole, depth + 1)
        })
    }

    /// The imports of each file, with the line of the first.
    pub fn imports(&self) -> BTreeMap<(usize, usize), usize> {
        let mut imports = BTreeMap::new();
        for mention in &self.mentions {
            let own = self.modules[&mention.module].file;
            if let Some(target) = self.resolve(&mention.module, &mention.path, 0)
                && target != own
            {
                imports.entry((own, target)).or_insert(mention.line);
            }
        }
        imports
    }
}
